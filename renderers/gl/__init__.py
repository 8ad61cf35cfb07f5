"""What wants a rasteriser: moderngl without a window, and the one place where its data crosses to Dr.Jit."""
