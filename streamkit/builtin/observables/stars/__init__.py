"""The observable `stars`: single stars, most of which may be of the field, against the model's track and widths."""
