"""Counters' companions: the message checksums of XBR and TSC1.

Both start from the sum of data bytes 1 to 7, the message counter and the four bytes of the CAN
identifier, as publicly described for SPN 3188 (XBR, 4 bits) and SPN 4207 (TSC1, 3 bits) by brake
and engine makers' integration guides:

    XBR    ((sum >> 4) + sum) & 0x0F
    TSC1   (((sum >> 6) & 0x03) + (sum >> 3) + sum) & 0x07
"""

from __future__ import annotations

from iits_mj.j1939.frame import Frame


def xbr_checksum(frame: Frame) -> int:
    """4-bit checksum of an XBR frame (or of our steering command, which uses the same rule)."""
    total = _sum(frame)
    return (total >> 4) + total & 0x0F


def tsc1_checksum(frame: Frame) -> int:
    """3-bit checksum of a TSC1 frame."""
    total = _sum(frame)
    return ((total >> 6) & 0x03) + (total >> 3) + total & 0x07


def counter_and_checksum(frame: Frame) -> tuple[int, int]:
    """Counter (bits 1 to 4) and checksum (bits 5 to 8) of byte 8."""
    return frame.data[7] & 0x0F, frame.data[7] >> 4


def with_byte8(frame: Frame, counter: int, checksum: int) -> Frame:
    """The frame with counter and checksum in byte 8."""
    last = bytes([checksum << 4 | counter & 0x0F])
    return Frame(frame.can_id, frame.data[:7] + last, frame.time)


def _sum(frame: Frame) -> int:
    return sum(frame.data[:7]) + (frame.data[7] & 0x0F) + sum(frame.can_id.to_bytes(4, "little"))
