"""The robot's oriented body on the ground: support, inclination, interference, unknown ground (paper eq. 1-4)."""

from planning.risk.body import BodyModel, pose_features

__all__ = ["BodyModel", "pose_features"]
