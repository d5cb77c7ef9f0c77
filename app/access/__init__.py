"""Access: keys, tokens, scopes, limits and the audit log."""
