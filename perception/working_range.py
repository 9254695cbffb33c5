"""The depths at which the sensor works."""

WORKING_RANGE_MM = (60.0, 140.0)
"""Nearest and farthest depth that an estimator may call valid and is measured at, millimetres. The paper measures contrast at
70 and 100 mm, and its errors imply a mean depth of 113 mm; with the nominal rig an order is unique from 57 to 163 mm."""
