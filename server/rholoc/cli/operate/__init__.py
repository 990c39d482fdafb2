"""Commands of who operates a service: start it, look after it, back it up."""
