"""The running system: processes, supervisor, what people see of it."""
