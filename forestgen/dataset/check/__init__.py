"""Whether a data set is what it claims to be: invariants over its files, and the places where they break."""
