"""LiDAR-inertial odometry and elevation mapping, on numpy values."""
