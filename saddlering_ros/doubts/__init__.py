"""What is doubtful in a record, on its rig, beside other records, or in a driver; in words."""
