"""Draw results as HTML pages and pictures, and provide the commands ``show`` and ``view``."""
