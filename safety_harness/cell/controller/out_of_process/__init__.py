"""A controller in a process of its own: a Python file, an ONNX policy, a program that speaks our protocol."""
