"""The tests of the node; run them by ``ros/test.sh``."""
