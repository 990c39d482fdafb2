"""What operators do: backups, certificates, checks."""
