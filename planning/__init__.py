"""Traversal-risk graph, body risk, search, smoothing and path tracking, on numpy values."""
