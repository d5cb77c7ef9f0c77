"""Bodies of requests: limits, compression and digests, checked before a route sees them."""
