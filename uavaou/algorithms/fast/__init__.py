"""What makes training fast and nothing else: without this folder everything trains, slower."""
