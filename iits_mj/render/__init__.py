"""What people see: films, pictures with instruments, plots and reports."""
