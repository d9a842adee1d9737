"""Set tasks with their limits, flown in virtual time without a link: what each class of vehicles reaches."""
