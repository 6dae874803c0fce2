"""What a robot is: a folder with `robot.yaml`, and beside it the model, controllers and envelopes that the file names.

`describe("go2w")` reads one of ours, `describe("path/to/folder")` that of somebody else. Nothing outside of this
package and of the backends names a robot: whoever needs a fact of it is given `Robot`, or numbers from it."""

from hal.robots.folders import DEFAULT, describe, envelope_file, folder_of, names
from hal.robots.outline import urdf
from hal.robots.robot import Body, Controller, Lanes, Robot, RobotError

__all__ = [
    "DEFAULT",
    "Body",
    "Controller",
    "Lanes",
    "Robot",
    "RobotError",
    "describe",
    "envelope_file",
    "folder_of",
    "names",
    "urdf",
]
