"""Authentication by tokens, sessions and login codes, and the audit log."""
