"""A real Go2-W: the same topics, services and semantics as Unitree's SDK, on our own DDS types.

`hal.unitree.factory.make_backend` is the entry. Only what needs it imports DDS, which is an optional package.
"""
