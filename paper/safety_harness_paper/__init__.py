"""The paper's tables and figures, measured again and set beside its own numbers."""
