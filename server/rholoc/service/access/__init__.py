"""Access control: keys and scopes, rates and quotas, the audit log, open streams."""
