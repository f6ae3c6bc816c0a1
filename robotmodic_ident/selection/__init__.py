"""Which terms a model has: forward selection by error reduction ratio, exchange of terms, and how many to keep."""
