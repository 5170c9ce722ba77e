"""Statistics: estimates from declared, independent streams of episodes, with bounds of measured coverage."""
