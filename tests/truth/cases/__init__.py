"""Cases of known truth: what methods must cope with, and each way they break."""
