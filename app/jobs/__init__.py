"""Jobs: builds and readings of captures, queued and run in processes of their own."""
