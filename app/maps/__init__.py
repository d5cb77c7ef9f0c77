"""Maps: the named containers of drives and revisions."""
