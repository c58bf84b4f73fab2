"""Files of calls and samples, which survive a kill at any moment."""
