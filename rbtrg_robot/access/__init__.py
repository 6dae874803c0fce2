"""Access from other computers: certificates, and Zenoh's rules made from the table of topics."""
