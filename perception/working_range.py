"""The depths at which the sensor works, and what counts as right and as wrong there."""

WORKING_RANGE_MM = (60.0, 140.0)
"""Nearest and farthest depth that an estimator may call valid and is measured at, millimetres. The paper measures contrast at
70 and 100 mm, and its errors imply a mean depth of 113 mm; with the nominal rig an order is unique from 57 to 163 mm."""

SLIP_FRACTION = 0.1
"""Relative error from which a depth is a slip: a fifth of a turn of phase or more. So is a depth that is called valid although
the true one lies outside of the working range."""

WITHIN_MM = 1.0
"""Error in millimetres of which a confidence is the probability not to exceed it."""
