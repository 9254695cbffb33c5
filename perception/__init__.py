"""One image in, one metric surface out. Would run on the real scope unchanged; never imports MuJoCo."""
