"""A map learns: from further recordings, from answered queries, from another map."""
