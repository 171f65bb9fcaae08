"""Drives in the formats of ASAM: OpenSCENARIO XML with OpenDRIVE, and OSI ground truth."""
