"""Optional features with extra dependencies. The core never imports them."""
