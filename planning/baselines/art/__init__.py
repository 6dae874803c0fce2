"""ART (leggedrobotics/art_planner): a roadmap of body poses whose legs reach the ground and whose torso does not touch it."""

from planning.baselines.art.params import ArtParams
from planning.baselines.art.plan import plan

__all__ = ["ArtParams", "plan"]
