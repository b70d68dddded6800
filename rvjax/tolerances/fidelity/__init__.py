"""Statistics of a high-fidelity response with the help of low-fidelity ones."""
