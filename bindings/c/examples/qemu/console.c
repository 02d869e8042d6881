// printf to the debugger's console, for %s, %u and %x with a width and zeros.
#include <stdarg.h>

#include "semihosting.h"
#include "stdio.h"

static char line[128];
static unsigned used;

static void put(char c) {
    line[used++] = c;
    if (c == '\n' || used == sizeof line - 1) {
        line[used] = 0;
        semihosting(SYS_WRITE0, line);
        used = 0;
    }
}

static void put_number(unsigned number, unsigned base, unsigned width) {
    char digits[16];
    unsigned count = 0;
    do {
        digits[count++] = "0123456789abcdef"[number % base];
        number /= base;
    } while (number > 0);
    while (count < width && count < sizeof digits) digits[count++] = '0';
    while (count > 0) put(digits[--count]);
}

int printf(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    for (; *format; format++) {
        if (*format != '%') {
            put(*format);
            continue;
        }
        unsigned width = 0;
        while (*++format >= '0' && *format <= '9') width = 10 * width + (unsigned)(*format - '0');
        if (*format == 's')
            for (const char *text = va_arg(arguments, const char *); *text; text++) put(*text);
        else
            put_number(va_arg(arguments, unsigned), *format == 'x' ? 16 : 10, width);
    }
    va_end(arguments);
    return 0;
}
