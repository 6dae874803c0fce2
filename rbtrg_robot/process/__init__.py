"""The processes of a running stack: started, watched, restarted and ended by the supervisor."""
