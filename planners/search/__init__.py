"""The receding-horizon search over motion primitives: beam search, nearest-goal search, and the kernels below them."""
