"""Missions as people write them: YAML files, GeoJSON, poses of a drive."""
