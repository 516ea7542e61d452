"""A policy taken along: an ONNX graph, the map as JSON, and a runner that needs neither torch nor this package."""
