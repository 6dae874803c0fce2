"""Missions: steps one after the other, and what happens when one fails or the operator is gone."""
