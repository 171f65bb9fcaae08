"""Evaluation: decision makers and parameter uncertainty, measured over many trips."""
