/* What an instance says, kept for Python: the first messages of a simulation say what went wrong, the rest repeat it.
 */
#ifndef LOG_H
#define LOG_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include "linkage.h"

enum { MOST_MESSAGES = 20, LONGEST_TEXT = 2048 };

typedef struct {
  int32_t status;
  char text[LONGEST_TEXT]; /* the end of a longer one is cut off */
} Message;

/* fmi2CallbackFunctions. */
typedef struct {
  void (*logger)(void *environment, const char *instance, int32_t status, const char *category, const char *format,
                 ...);
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(void *, int32_t);
  void *environment;
} Callbacks;

typedef struct {
  atomic_int count; /* of all messages, also of those that are not kept */
  Message messages[MOST_MESSAGES];
  Callbacks callbacks;
} Log;

/* What an instance of FMI 2.0 may call, to be heard in this log; memory comes from the C library. */
EXPORT const Callbacks *log_open(Log *log);

/* fmi3LogMessageCallback, with a Log as the environment. */
EXPORT void log_message_3(void *environment, int32_t status, const char *category, const char *message);

#endif
