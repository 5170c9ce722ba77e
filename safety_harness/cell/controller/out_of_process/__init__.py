"""Run a controller in its own process: a Python file, an ONNX policy, or a program that uses the protocol."""
