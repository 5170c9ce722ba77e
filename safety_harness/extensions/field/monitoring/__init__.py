"""The monitor: it judges claims on a live cell from one sample after another."""
