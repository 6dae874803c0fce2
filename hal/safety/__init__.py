"""The safety gate in front of every robot, its geofence, the tilt it watches, and the table of monitors."""
