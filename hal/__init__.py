"""The robot: contract, value types, robots, safety gate; simulators and hardware behind it."""

import os
import sys

# A kept kernel counts only while everything it was compiled from is the same, see `hal/kernel_cache.py`. Numba's own
# classes are for notebooks.
os.environ.setdefault(
    "NUMBA_CACHE_LOCATOR_CLASSES",
    "hal.kernel_cache.UserProvided,hal.kernel_cache.InTree,hal.kernel_cache.UserWide,IPythonCacheLocator,ZipCacheLocator",
)
# Each signature that does not fit is told in colours, to nobody: a twentieth of the time that compiling takes.
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
if "numba" in sys.modules:  # somebody imported it first
    sys.modules["numba"].core.config.reload_config()
