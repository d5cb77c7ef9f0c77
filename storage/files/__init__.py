"""Files of a data directory: durable writes, checked reads, and what each kind of file holds."""
