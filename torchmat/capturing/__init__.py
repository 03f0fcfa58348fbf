"""From photographs of a flat sample on a printed board to a rectified, calibrated BTF.

Frame: the sample's plane is z = 0, in millimetres, its origin the centre of the board's window, x right, y up, z towards
the camera; directions point away from the surface. OpenCV comes with the extra `capture`.
"""
