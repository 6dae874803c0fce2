"""The console: a page in the browser on which people see what the robot sees, stop it, and send it somewhere."""
