/* Counts the guest instructions of an emulated Cortex-M, exactly and the same in every run: a plugin for QEMU's TCG.
 *
 * The guest marks what is counted with the hint DBG #n, which does nothing on silicon: #1 to #14 begin region n and end
 * the one before, #0 ends it. Markers themselves are not counted. With `places=1` the counts of
 * every address inside a region are reported as well, to be assigned to functions.
 *
 *     cc -O2 -fPIC -shared -o count.so count.c
 *     qemu-system-arm ... -plugin ./count.so[,places=1] -d plugin -D log
 *
 * What is declared here is the part of version 1 of the plugin interface (QEMU 5 to 8) that is used: distributions ship
 * programs that export it, but no header.
 */
#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t plugin_id;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
enum flags { NO_REGISTERS };
enum operation { ADD };

extern void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, void (*)(plugin_id, struct qemu_plugin_tb *));
extern void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, void (*)(unsigned, void *), enum flags, void *);
extern void qemu_plugin_register_vcpu_insn_exec_inline(struct qemu_plugin_insn *, enum operation, void *, uint64_t);
extern void qemu_plugin_register_atexit_cb(plugin_id, void (*)(plugin_id, void *), void *);
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
extern struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
extern const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *);
extern uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);
extern void qemu_plugin_outs(const char *);
__attribute__((visibility("default"))) int qemu_plugin_version = 1;

enum { REGIONS = 15, BUCKETS = 1 << 14 };

static uint64_t executed;
static uint64_t began;
static int region;
static uint64_t counts[REGIONS], entries[REGIONS];
static bool by_place;

/* Instructions executed at one address, those inside a region taken off at its end. */
struct place {
    uint64_t address, executed, at_begin, counted;
    struct place *next;
};
static struct place *places[BUCKETS];

static struct place *place_at(uint64_t address)
{
    struct place **bucket = &places[(address >> 1) % BUCKETS];
    for (struct place *p = *bucket; p; p = p->next)
        if (p->address == address) return p;
    struct place *p = calloc(1, sizeof *p);
    if (!p) abort();
    p->address = address;
    p->next = *bucket;
    return *bucket = p;
}

static void for_places(void (*f)(struct place *))
{
    for (int b = 0; b < BUCKETS; b++)
        for (struct place *p = places[b]; p; p = p->next) f(p);
}

static void place_begins(struct place *p) { p->at_begin = p->executed; }
static void place_ends(struct place *p) { p->counted += p->executed - p->at_begin; }

static void marker(unsigned vcpu, void *number)
{
    (void)vcpu;
    if (region) {
        counts[region] += executed - began;
        if (by_place) for_places(place_ends);
    }
    region = (int)(intptr_t)number % REGIONS;
    if (!region) return;
    entries[region]++;
    began = executed;
    if (by_place) for_places(place_begins);
}

static void translated(plugin_id id, struct qemu_plugin_tb *block)
{
    (void)id;
    size_t count = qemu_plugin_tb_n_insns(block);
    for (size_t i = 0; i < count; i++) {
        struct qemu_plugin_insn *insn = qemu_plugin_tb_get_insn(block, i);
        const uint8_t *code = qemu_plugin_insn_data(insn);
        /* DBG #n: halfwords F3AF, 80Fn. */
        if (code[0] == 0xAF && code[1] == 0xF3 && code[3] == 0x80 && (code[2] & 0xF0) == 0xF0) {
            qemu_plugin_register_vcpu_insn_exec_cb(insn, marker, NO_REGISTERS, (void *)(intptr_t)(code[2] & 15));
            continue;
        }
        qemu_plugin_register_vcpu_insn_exec_inline(insn, ADD, &executed, 1);
        if (by_place)
            qemu_plugin_register_vcpu_insn_exec_inline(insn, ADD, &place_at(qemu_plugin_insn_vaddr(insn))->executed, 1);
    }
}

static void print_place(struct place *p)
{
    char line[64];
    if (!p->counted) return;
    snprintf(line, sizeof line, "at %08" PRIx64 " %" PRIu64 "\n", p->address, p->counted);
    qemu_plugin_outs(line);
}

static void report(plugin_id id, void *unused)
{
    (void)id;
    (void)unused;
    char line[96];
    for (int r = 1; r < REGIONS; r++) {
        if (!entries[r]) continue;
        snprintf(line, sizeof line, "region %d entries %" PRIu64 " instructions %" PRIu64 "\n", r, entries[r], counts[r]);
        qemu_plugin_outs(line);
    }
    if (by_place) for_places(print_place);
}

__attribute__((visibility("default"))) int qemu_plugin_install(plugin_id id, const void *info, int argc, char **argv)
{
    (void)info;
    for (int i = 0; i < argc; i++) by_place |= !strcmp(argv[i], "places=1");
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, report, NULL);
    return 0;
}
