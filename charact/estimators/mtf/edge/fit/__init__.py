"""Blur models fitted to an oversampled edge profile and averaged by their evidence."""
