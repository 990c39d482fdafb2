"""Tools for operators: backups, certificates, checks."""
