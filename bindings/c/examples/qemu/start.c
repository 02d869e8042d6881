// Reset to main on a Cortex-M4F, and what the image took when main is done.
#include <stddef.h>

#include "semihosting.h"
#include "stdio.h"

enum { FAULT = 102, PAINT = 0x5EADBEE5 };

// From the linker script.
extern uint32_t data_start[], data_end[], data_source[], bss_start[], bss_end[], stack_bottom[], stack_top[];
extern const char runtime_start[], runtime_end[];

int main(void);
void reset(void);

static void fault(void) { leave(FAULT); }

struct vectors {
    uint32_t *stack;
    void (*handlers[15])(void); // reset, NMI, hard fault, memory management, bus, usage
};

__attribute__((section(".vectors"), used)) static const struct vectors vectors = {
    .stack = stack_top,
    .handlers = {reset, fault, fault, fault, fault, fault},
};

static void report(void) {
    const uint32_t *lowest = stack_bottom;
    while (lowest < stack_top && *lowest == PAINT) lowest++;
    printf("image: %u bytes of code and constants of the runtime, %u bytes of stack, %u bytes of data\n",
           (unsigned)(runtime_end - runtime_start), (unsigned)((stack_top - lowest) * sizeof *lowest),
           (unsigned)((bss_end - data_start) * sizeof *bss_end));
}

static __attribute__((noreturn, noinline)) void run(void) {
    int status = main();
    report();
    leave((uint32_t)status);
}

__attribute__((noreturn)) void reset(void) {
    volatile uint32_t *const cpacr = (volatile uint32_t *)0xE000ED88;
    *cpacr |= 0xFu << 20; // the floating-point unit is off after reset
    __asm__ volatile("dsb\n\tisb" ::: "memory");
    for (uint32_t *to = data_start, *from = data_source; to < data_end;) *to++ = *from++;
    for (uint32_t *to = bss_start; to < bss_end;) *to++ = 0;
    uint32_t *here = __builtin_frame_address(0);
    for (uint32_t *to = stack_bottom; to < here - 16;) *to++ = PAINT;
    run();
}
