"""A run as text, pictures, a page, and files for other programs."""
