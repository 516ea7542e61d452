"""The networks that the algorithms share."""
