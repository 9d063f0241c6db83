// The card slot: a card is in it unless the environment says NO_SD_CARD.
#pragma once
#include "Arduino.h"

class File : public Print {
  public:
    explicit operator bool() const { return true; }
    void close() {}

  protected:
    void put(const char *, size_t) override {}
};

class SDClass {
  public:
    bool begin(int) { return getenv("NO_SD_CARD") == nullptr; }
    File open(const char *, int) { return File(); }
};
extern SDClass SD;
