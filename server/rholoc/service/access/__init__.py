"""Who may do what: keys and their scopes, rates and quotas, the audit log, open streams."""
