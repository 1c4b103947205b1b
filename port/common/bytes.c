// The four functions on bytes that a compiler calls by itself: a word at a time where both ends are on words, else a
// byte. Those of the C libraries are larger, or take a byte at a time where this clears 36 KB at every start.
#include <stdint.h>
#include <string.h>

// Without it the compiler would see that a loop is memset, and call it from itself.
#if defined(__clang__)
#define AS_WRITTEN __attribute__((no_builtin("memset", "memcpy", "memmove")))
#else
#define AS_WRITTEN __attribute__((optimize("no-tree-loop-distribute-patterns")))
#endif

// Memory of any type, seen as words.
typedef uint32_t __attribute__((may_alias)) word_t;

AS_WRITTEN void *memset(void *to, int value, size_t count) {
    const uint8_t byte = (uint8_t)value;
    uint8_t *at = to, *end = at + count;
    for (; at < end && ((uintptr_t)at & 3U) != 0; at++)
        *at = byte;
    const uint32_t word = byte * 0x01010101U;
    for (; end - at >= 32; at += 32) {
        word_t *words = (word_t *)(void *)at;
        words[0] = words[1] = words[2] = words[3] = words[4] = words[5] = words[6] = words[7] = word;
    }
    for (; end - at >= 4; at += 4)
        *(word_t *)(void *)at = word;
    for (; at < end; at++)
        *at = byte;
    return to;
}

AS_WRITTEN void *memcpy(void *restrict to, const void *restrict from, size_t count) {
    uint8_t *at = to;
    const uint8_t *next = from;
    if ((((uintptr_t)at | (uintptr_t)next) & 3U) == 0)
        for (; count >= 4; count -= 4, at += 4, next += 4)
            *(word_t *)(void *)at = *(const word_t *)(const void *)next;
    for (; count > 0; count--)
        *at++ = *next++;
    return to;
}

AS_WRITTEN void *memmove(void *to, const void *from, size_t count) {
    uint8_t *at = to;
    const uint8_t *next = from;
    if ((uintptr_t)at - (uintptr_t)next >= count)  // also where it is before: upwards nothing is lost
        return memcpy(to, from, count);
    while (count > 0) {
        count--;
        at[count] = next[count];
    }
    return to;
}

AS_WRITTEN int memcmp(const void *a, const void *b, size_t count) {
    const uint8_t *one = a, *other = b;
    for (; count > 0; count--, one++, other++)
        if (*one != *other)
            return *one < *other ? -1 : 1;
    return 0;
}
