"""Recordings: scans, poses, drives and sensors."""
