"""How programs are compiled, kept between processes, and spread over devices."""
