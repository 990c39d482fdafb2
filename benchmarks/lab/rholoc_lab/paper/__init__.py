"""The paper's map generator: observations of a walk (Table 4), and densities fitted to them."""
