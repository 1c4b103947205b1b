/// For the few functions whose call would cost as much as their work: inlined also where a compiler optimises for size.
#ifndef CANOPY_INLINE_H
#define CANOPY_INLINE_H

#if defined(__GNUC__)
#define CANOPY_INLINE static inline __attribute__((always_inline))
#else
#define CANOPY_INLINE static inline
#endif

#endif
