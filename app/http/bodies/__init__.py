"""Request bodies: limits, compression and digests, checked before a route reads them."""
