"""What measures rholoc, and is no part of it: comparisons, simulated buildings, the paper's own data flow."""
