"""The robot: contract, value types, robots, safety gate; simulators and hardware behind it."""

import os
import sys

# A kept kernel counts only while everything it was compiled from is the same, see `hal/kernel_cache.py`. Numba's own
# classes are for notebooks.
os.environ.setdefault(
    "NUMBA_CACHE_LOCATOR_CLASSES",
    "hal.kernel_cache.UserProvided,hal.kernel_cache.InTree,hal.kernel_cache.UserWide,IPythonCacheLocator,ZipCacheLocator",
)
# Numba writes in colours, to nobody, why each signature that it tries does not fit.
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
if "numba" in sys.modules:  # somebody imported it first
    sys.modules["numba"].core.config.reload_config()
