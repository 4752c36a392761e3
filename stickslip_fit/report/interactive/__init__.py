"""What a page's script is given, and a policy that lets nothing else run."""
