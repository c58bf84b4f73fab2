"""Where and when a progenitor releases particles."""
