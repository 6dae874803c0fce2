"""Who from outside the robot's computer may do what: certificates, and Zenoh's rules made from the table of topics."""
