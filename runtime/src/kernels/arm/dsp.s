@ int16 rows times int8 weights on Armv7E-M and Armv8-M with the DSP extension.
@
@ A panel holds four rows of activations: for every four inputs k (a quad) eight words, the pairs (k0, k2) of the four
@ rows, then their pairs (k1, k3). SXTB16 takes four weights apart in just this order. A wide tile holds four channels of
@ weights as int16: for every quad, two words a channel in the same order.

.syntax unified
.thumb

@ One quad of four rows by one channel of int8 weights: 16 products in 13 instructions.
.macro mtn_step_s8
  ldr r2, [r0], #4
  ldm r1!, {r8-r11}
  sxtb16 r3, r2
  smlad r4, r3, r8, r4
  smlad r5, r3, r9, r5
  smlad r6, r3, r10, r6
  smlad r7, r3, r11, r7
  ldm r1!, {r8-r11}
  sxtb16 r3, r2, ror #8
  smlad r4, r3, r8, r4
  smlad r5, r3, r9, r5
  smlad r6, r3, r10, r6
  smlad r7, r3, r11, r7
.endm

@ The same with weights of a wide tile: 11 instructions.
.macro mtn_step_s16
  ldrd r2, r3, [r0], #32
  ldm r1!, {r8-r11}
  smlad r4, r2, r8, r4
  smlad r5, r2, r9, r5
  smlad r6, r2, r10, r6
  smlad r7, r2, r11, r7
  ldm r1!, {r8-r11}
  smlad r4, r3, r8, r4
  smlad r5, r3, r9, r5
  smlad r6, r3, r10, r6
  smlad r7, r3, r11, r7
.endm

@ Two quads of one row by one channel: 8 products.
.macro mtn_half w, sum
  ldrd r2, r3, [\w], #8
  sxtb16 r7, r2
  sxtb16 r2, r2, ror #8
  smlad \sum, r7, r8, \sum
  smlad \sum, r2, r9, \sum
  sxtb16 r7, r3
  sxtb16 r3, r3, ror #8
  smlad \sum, r7, r10, \sum
  smlad \sum, r3, r11, \sum
.endm

@ One pair of inputs, the weights that lie \shift bits up in \word, by four rows. r12 holds the mask 000f000f.
.macro mtn_pair_s4 word, shift
  ldm r1!, {r8-r11}
  and lr, r12, \word, lsr #\shift
  smlad r4, lr, r8, r4
  smlad r5, lr, r9, r5
  smlad r6, lr, r10, r6
  smlad r7, lr, r11, r7
.endm

@ One group of sixteen inputs of four rows by one channel of 4-bit weights: 64 products in 49 instructions.
.macro mtn_step_s4
  ldrd r2, r3, [r0], #8
  mtn_pair_s4 r2, 0
  mtn_pair_s4 r2, 8
  mtn_pair_s4 r3, 0
  mtn_pair_s4 r3, 8
  mtn_pair_s4 r2, 4
  mtn_pair_s4 r2, 12
  mtn_pair_s4 r3, 4
  mtn_pair_s4 r3, 12
.endm

@ r4 <- address in a loop of eight steps of \bytes each at \loop, such that r2 steps remain in whole loops.
.macro mtn_entry bytes, loop
  rsb r4, r2, #0
  and r4, r4, #7
  mov r5, #\bytes
  mul r4, r4, r5
  adr r5, \loop
  add r4, r4, r5
  orr r4, r4, #1
.endm

@ One column of four rows: sums the steps from r1 to r12, entered as [sp, #4] says, and writes the sums to lr, which moves on.
@ [sp, #8] and [sp, #12] come into r2, bytes from row to row of acc, and r3.
.macro mtn_column step
  movs r4, #0
  movs r5, #0
  movs r6, #0
  movs r7, #0
  ldr pc, [sp, #4]
  .p2align 2
1:
  .rept 8
  \step
  .endr
  cmp r1, r12
  bne 1b
  ldrd r2, r3, [sp, #8]
  add r8, lr, r2, lsl #1
  str r5, [lr, r2]
  str r4, [lr], #4
  str r7, [r8, r2]
  str r6, [r8]
.endm

@ mtn_pack4(rows: [pointer; 4], panel, quads): four rows of int16 to a panel.
.section .text.mtn_pack4, "ax", %progbits
.p2align 2
.global mtn_pack4
.type mtn_pack4, %function
.thumb_func
mtn_pack4:
  push {r4-r11, lr}
  mov r12, r1
  mov lr, r2
  ldm r0, {r0-r3}
1:
  ldr r4, [r0], #4
  ldr r5, [r0], #4
  ldr r6, [r1], #4
  ldr r7, [r1], #4
  pkhbt r8, r4, r5, lsl #16
  pkhtb r10, r5, r4, asr #16
  pkhbt r9, r6, r7, lsl #16
  pkhtb r11, r7, r6, asr #16
  strd r8, r9, [r12], #32
  strd r10, r11, [r12, #-16]
  ldr r4, [r2], #4
  ldr r5, [r2], #4
  ldr r6, [r3], #4
  ldr r7, [r3], #4
  pkhbt r8, r4, r5, lsl #16
  pkhtb r10, r5, r4, asr #16
  pkhbt r9, r6, r7, lsl #16
  pkhtb r11, r7, r6, asr #16
  strd r8, r9, [r12, #-24]
  strd r10, r11, [r12, #-8]
  subs lr, lr, #1
  bne 1b
  pop {r4-r11, pc}

@ mtn_pack1(row, panel, quads): one row, two words a quad.
.section .text.mtn_pack1, "ax", %progbits
.p2align 2
.global mtn_pack1
.type mtn_pack1, %function
.thumb_func
mtn_pack1:
  push {r4, lr}
1:
  ldr r3, [r0], #4
  ldr r4, [r0], #4
  pkhbt r12, r3, r4, lsl #16
  pkhtb r4, r4, r3, asr #16
  strd r12, r4, [r1], #8
  subs r2, r2, #1
  bne 1b
  pop {r4, pc}

@ mtn_widen4(w, row bytes, quads, tile): four channels, rows of w, to a wide tile.
.section .text.mtn_widen4, "ax", %progbits
.p2align 2
.global mtn_widen4
.type mtn_widen4, %function
.thumb_func
mtn_widen4:
  push {r4-r11, lr}
  add r12, r0, r1, lsl #1
1:
  ldr r5, [r0, r1]
  ldr r4, [r0], #4
  ldr r7, [r12, r1]
  ldr r6, [r12], #4
  sxtb16 r8, r4
  sxtb16 r9, r4, ror #8
  strd r8, r9, [r3], #8
  sxtb16 r10, r5
  sxtb16 r11, r5, ror #8
  strd r10, r11, [r3], #8
  sxtb16 r8, r6
  sxtb16 r9, r6, ror #8
  strd r8, r9, [r3], #8
  sxtb16 r10, r7
  sxtb16 r11, r7, ror #8
  strd r10, r11, [r3], #8
  subs r2, r2, #1
  bne 1b
  pop {r4-r11, pc}

@ mtn_widen4_transposed(w, row bytes, quads, tile): four channels, columns of w, to a wide tile; a quad is four rows.
.section .text.mtn_widen4_transposed, "ax", %progbits
.p2align 2
.global mtn_widen4_transposed
.type mtn_widen4_transposed, %function
.thumb_func
mtn_widen4_transposed:
  push {r4-r11, lr}
1:
  ldr r4, [r0]
  ldr r5, [r0, r1]
  add r0, r0, r1, lsl #1
  ldr r6, [r0]
  ldr r7, [r0, r1]
  add r0, r0, r1, lsl #1
  sxtb16 r8, r4
  sxtb16 r9, r6
  pkhbt r10, r8, r9, lsl #16
  pkhtb r8, r9, r8, asr #16
  sxtb16 r9, r5
  sxtb16 r12, r7
  pkhbt r11, r9, r12, lsl #16
  pkhtb r9, r12, r9, asr #16
  strd r10, r11, [r3], #32
  strd r8, r9, [r3, #-16]
  sxtb16 r8, r4, ror #8
  sxtb16 r9, r6, ror #8
  pkhbt r10, r8, r9, lsl #16
  pkhtb r8, r9, r8, asr #16
  sxtb16 r9, r5, ror #8
  sxtb16 r12, r7, ror #8
  pkhbt r11, r9, r12, lsl #16
  pkhtb r9, r12, r9, asr #16
  strd r10, r11, [r3, #-24]
  strd r8, r9, [r3, #-8]
  subs r2, r2, #1
  bne 1b
  pop {r4-r11, pc}

@ mtn_dot4_s8(w, panel, quads, acc, channels, row bytes of acc): four rows by int8 channels that follow each other.
.section .text.mtn_dot4_s8, "ax", %progbits
.p2align 2
.global mtn_dot4_s8
.type mtn_dot4_s8, %function
.thumb_func
mtn_dot4_s8:
  push {r4-r11, lr}
  sub sp, sp, #20
  mtn_entry 52, 1f
  ldr r6, [sp, #56]
  ldr r7, [sp, #60]
  mov lr, r3
  add r6, lr, r6, lsl #2
  strd r1, r4, [sp]
  strd r7, r6, [sp, #8]
  add r12, r1, r2, lsl #5
2:
  ldr r1, [sp]
  mtn_column mtn_step_s8
  cmp lr, r3
  bne 2b
  add sp, sp, #20
  pop {r4-r11, pc}

@ mtn_dot4_s16(tile, panels, quads, acc, groups, row bytes of acc): groups of four rows by the four channels of a wide tile.
.section .text.mtn_dot4_s16, "ax", %progbits
.p2align 2
.global mtn_dot4_s16
.type mtn_dot4_s16, %function
.thumb_func
mtn_dot4_s16:
  push {r4-r11, lr}
  sub sp, sp, #28
  mtn_entry 44, 1f
  ldr r6, [sp, #64]
  ldr r7, [sp, #68]
  lsl r5, r2, #5
  strd r0, r4, [sp]
  strd r7, r5, [sp, #8]
  strd r3, r6, [sp, #16]
  add r12, r1, r5
3:
  ldr lr, [sp, #16]
  add r2, lr, #16
  str r2, [sp, #24]
2:
  mtn_column mtn_step_s16
  subs r1, r1, r3
  subs r0, r0, r3
  adds r0, r0, #8
  ldr r8, [sp, #24]
  cmp lr, r8
  bne 2b
  ldr r0, [sp]
  add r1, r1, r3
  add r12, r12, r3
  ldrd r8, r9, [sp, #16]
  add r8, r8, r2, lsl #2
  subs r9, r9, #1
  strd r8, r9, [sp, #16]
  bne 3b
  add sp, sp, #28
  pop {r4-r11, pc}

@ mtn_dot1_s8(w, row, steps, acc, bytes of acc, row bytes of w): one row, steps of two quads, two channels at a time.
.section .text.mtn_dot1_s8, "ax", %progbits
.p2align 2
.global mtn_dot1_s8
.type mtn_dot1_s8, %function
.thumb_func
mtn_dot1_s8:
  push {r4-r11, lr}
  sub sp, sp, #20
  mtn_entry 76, 1f
  ldr r6, [sp, #56]
  ldr r7, [sp, #60]
  add r6, r3, r6
  strd r1, r7, [sp]
  strd r4, r6, [sp, #8]
  mov r12, r3
  add lr, r1, r2, lsl #4
2:
  ldrd r1, r6, [sp]
  add r6, r0, r6
  movs r4, #0
  movs r5, #0
  ldr pc, [sp, #8]
  .p2align 2
1:
  .rept 8
  ldm r1!, {r8-r11}
  mtn_half r0, r4
  mtn_half r6, r5
  .endr
  cmp r1, lr
  bne 1b
  mov r0, r6
  strd r4, r5, [r12], #8
  ldr r3, [sp, #12]
  cmp r12, r3
  bne 2b
  add sp, sp, #20
  pop {r4-r11, pc}

@ mtn_dot4_s4(w, panel, quads, acc, channels, row bytes of acc): four rows by 4-bit channels that follow each other. Weights are
@ stored with 8 added, so sums begin at -8 times those of their rows.
.section .text.mtn_dot4_s4, "ax", %progbits
.p2align 2
.global mtn_dot4_s4
.type mtn_dot4_s4, %function
.thumb_func
mtn_dot4_s4:
  push {r4-r11, lr}
  sub sp, sp, #44
  movs r4, #0
  movs r5, #0
  movs r6, #0
  movs r7, #0
  mov r12, #0x00010001
  add lr, r1, r2, lsl #5
  strd r1, lr, [sp]
1:
  ldm r1!, {r8-r11}
  smlad r4, r12, r8, r4
  smlad r5, r12, r9, r5
  smlad r6, r12, r10, r6
  smlad r7, r12, r11, r7
  cmp r1, lr
  bne 1b
  movs r1, #0
  sub r4, r1, r4, lsl #3
  sub r5, r1, r5, lsl #3
  sub r6, r1, r6, lsl #3
  sub r7, r1, r7, lsl #3
  strd r4, r5, [sp, #24]
  strd r6, r7, [sp, #32]
  mov r12, #0x000f000f
  adr r4, 3f
  tst r2, #4
  it ne
  addne r4, r4, #196
  orr r4, r4, #1
  ldr r6, [sp, #80]
  ldr r7, [sp, #84]
  add r6, r3, r6, lsl #2
  strd r4, r3, [sp, #8]
  strd r6, r7, [sp, #16]
2:
  ldrd r4, r5, [sp, #24]
  ldrd r6, r7, [sp, #32]
  ldr r1, [sp]
  ldr pc, [sp, #8]
  .p2align 2
3:
  .rept 2
  mtn_step_s4
  .endr
  ldr lr, [sp, #4]
  cmp r1, lr
  bne 3b
  ldrd r8, r9, [sp, #12]
  ldr r10, [sp, #20]
  add r11, r8, r10, lsl #1
  str r5, [r8, r10]
  str r4, [r8], #4
  str r7, [r11, r10]
  str r6, [r11]
  str r8, [sp, #12]
  cmp r8, r9
  bne 2b
  add sp, sp, #44
  pop {r4-r11, pc}

@ mtn_dot1_transposed(w, row bytes of w, row, pairs, acc): two rows of w for each pair of inputs; four columns.
.section .text.mtn_dot1_transposed, "ax", %progbits
.p2align 2
.global mtn_dot1_transposed
.type mtn_dot1_transposed, %function
.thumb_func
mtn_dot1_transposed:
  push {r4-r11, lr}
  movs r4, #0
  movs r5, #0
  movs r6, #0
  movs r7, #0
1:
  ldr r11, [r2], #4
  ldr r8, [r0]
  ldr r12, [r0, r1]
  add r0, r0, r1, lsl #1
  sxtb16 r9, r8
  sxtb16 r10, r8, ror #8
  smlabb r4, r9, r11, r4
  smlatb r6, r9, r11, r6
  smlabb r5, r10, r11, r5
  smlatb r7, r10, r11, r7
  sxtb16 r9, r12
  sxtb16 r10, r12, ror #8
  smlabt r4, r9, r11, r4
  smlatt r6, r9, r11, r6
  smlabt r5, r10, r11, r5
  smlatt r7, r10, r11, r7
  subs r3, r3, #1
  bne 1b
  ldr r12, [sp, #36]
  stm r12, {r4-r7}
  pop {r4-r11, pc}

.text
