// The little of <stdio.h> that walk.c uses: there is no C library in this image.
#pragma once

int printf(const char *format, ...) __attribute__((format(printf, 1, 2)));
