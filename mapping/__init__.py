"""LiDAR-inertial odometry and elevation mapping, on numpy values."""

import hal as hal  # which says where numba keeps kernels
