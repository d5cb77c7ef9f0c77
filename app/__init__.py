"""The service: settings, routes, jobs and the command line."""
