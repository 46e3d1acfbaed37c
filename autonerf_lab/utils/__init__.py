"""File storage, machine resources, optional packages and plug-ins."""
