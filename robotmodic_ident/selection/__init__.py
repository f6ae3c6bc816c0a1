"""Selection of terms: forward selection by error reduction ratio, exchange of terms, and the model size."""
