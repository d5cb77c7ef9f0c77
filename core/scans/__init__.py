"""What is recorded: scans, poses, drives and the sensors that make them."""
