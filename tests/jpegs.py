"""Unusual JPEGs, which no camera writes."""

from __future__ import annotations


def jpeg_of_scans(scans: int) -> bytes:
    """Encode 8 x 8 grey pixels in up to 896 scans of a bit each, after a comment of 5 kB."""
    order = [(0, bit) for bit in range(14)] + [(place, bit) for place in range(1, 64) for bit in range(14)]
    tables = b"".join(
        b"\xff\xc4\x00\x14" + bytes([kind, 1, *[0] * 15, 0]) for kind in (0x00, 0x10)
    )  # one code, '0', for 'no bits follow' and for 'the block ends'
    parts = b"".join(
        b"\xff\xda\x00\x08\x01\x01\x00" + bytes([place, place, (14 - bit) % 14 << 4 | 13 - bit, 0x7F])
        for place, bit in order[:scans]
    )
    quantisation = b"\xff\xdb\x00\x43\x00" + b"\x01" * 64
    frame = b"\xff\xc2\x00\x0b\x08\x00\x08\x00\x08\x01\x01\x11\x00"
    comment = b"\xff\xfe\x13\x88" + bytes(4998)
    return b"\xff\xd8" + comment + quantisation + frame + tables + parts + b"\xff\xd9"
