"""Families of terms, one file each."""
