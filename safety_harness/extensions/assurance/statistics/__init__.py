"""Statistics: estimates of declared, independent streams of episodes, with bounds of checked coverage."""
