"""Who may come in: tokens, sessions, login codes, and the audit log."""
