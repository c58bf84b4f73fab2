"""What is measured of a stream and compared with data."""
