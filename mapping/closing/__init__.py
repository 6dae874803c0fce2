"""Maps that close: one or more runs in, their loops and the map along the corrected way out."""

from mapping.closing.close import Closed, Closing, Loop
from mapping.closing.fuse import corrected, fuse, fusing
from mapping.closing.recording import Recording
from mapping.closing.verify import Refusal

__all__ = ["Closed", "Closing", "Loop", "Recording", "Refusal", "corrected", "fuse", "fusing"]
