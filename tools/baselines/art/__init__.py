"""ART (leggedrobotics/art_planner): a roadmap of body poses whose legs reach the ground and whose torso does not touch
it."""

from tools.baselines.art.params import ArtParams
from tools.baselines.art.plan import plan, unmasked

__all__ = ["ArtParams", "plan", "unmasked"]
