"""`sitl fuzz`: hostile input at every door of the service, seeded and repeatable, on virtual time."""
