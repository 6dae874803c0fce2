"""The wire: key expressions, CDR, frames and the Zenoh session, as rmw_zenoh makes them."""
