"""Videos, pictures with instruments, plots and pages."""
