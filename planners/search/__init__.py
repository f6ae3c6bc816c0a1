"""Receding-horizon search over motion primitives: beam search, nearest-goal search, and their compiled kernels."""
