"""Poses from scans and wheels: in a known place, or in a new one."""
