"""What all routes share: bodies, errors, connections, pools, logs and metrics."""
