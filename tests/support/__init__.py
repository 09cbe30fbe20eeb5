"""What tests are made of: FMUs, models, problems, studies."""
