"""Make scenarios and spaces from the logs of real cells, and compare both worlds with these logs."""
