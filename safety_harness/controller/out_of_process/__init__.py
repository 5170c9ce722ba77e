"""A user's controller in a process of its own: a Python file, an ONNX policy, any program that speaks our protocol."""
