"""A client that uploads recorded drives to a service: `tensormap upload`."""
