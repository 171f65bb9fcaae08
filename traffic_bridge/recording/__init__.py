"""Recordings: what a drive's traffic did, in memory and in files."""
