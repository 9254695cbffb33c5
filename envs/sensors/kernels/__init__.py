"""Warp kernels; the same code runs on CPU and CUDA."""
