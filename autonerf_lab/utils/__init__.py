"""Storage, machine resources, optional packages and plug-ins."""
