"""Monte Carlo statistics of any sample size, in constant memory."""
